"""Where simulation and recordings differ, what physics was left out, and what it adds."""
