"""`python -m stiffopt`."""

from stiffopt.cli import main

main()
