"""Helpers shared by several test folders lie beside this file, which makes them importable."""

import signal

from hypothesis import settings

# What runs in the background of a shell is deaf to Ctrl-C, and so is all that it starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same commit gives the same answer; --hypothesis-profile explore draws examples of its own.
settings.register_profile("default", derandomize=True, database=None)
settings.register_profile("explore", derandomize=False, print_blob=True)
settings.load_profile("default")
