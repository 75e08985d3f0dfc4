"""What people ask for as a whole: a solved trajectory, a stiffness study, a verification."""
