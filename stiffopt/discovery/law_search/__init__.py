"""Search for laws that no catalogue has, in the residual that the catalogue leaves."""
