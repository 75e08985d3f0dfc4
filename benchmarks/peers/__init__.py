"""The UR10's problems by stiffopt and by peers, judged alike."""
