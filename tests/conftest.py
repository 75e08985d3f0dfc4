"""Helpers shared by several test folders lie beside this file, which makes them importable."""

import os

from hypothesis import settings

# Hundreds of small problems would each start a compiler; tests of compiled stages ask for it.
os.environ["STIFFOPT_COMPILE"] = "never"

# The same commit gives the same answer; --hypothesis-profile explore draws examples of its own.
settings.register_profile("default", derandomize=True, database=None)
settings.register_profile("explore", derandomize=False, print_blob=True)
settings.load_profile("default")
