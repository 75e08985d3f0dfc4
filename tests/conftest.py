"""Helpers shared by several test folders lie beside this file, which makes them importable."""

import os
import signal

from hypothesis import settings

# What runs in the background of a shell is deaf to Ctrl-C, and so is all that it starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Hundreds of small problems would each start a compiler; tests of compiled stages ask for it.
os.environ["STIFFOPT_COMPILE"] = "package"

# The same commit gives the same answer; --hypothesis-profile explore draws examples of its own.
settings.register_profile("default", derandomize=True, database=None)
settings.register_profile("explore", derandomize=False, print_blob=True)
settings.load_profile("default")


def pytest_configure(config):
    """Compile the package's own C code before workers start: it simulates 20 times as fast."""
    if not hasattr(config, "workerinput"):
        from stiffopt import compiler
        from stiffopt.elastic import native
        from stiffopt.robot import native_bodies
        from stiffopt.solver import frontal

        native.prepare()
        native_bodies.prepare()
        frontal.library()
        compiler.wait()
