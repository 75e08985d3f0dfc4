"""`stiffopt cache`: cache of compiled functions."""

from __future__ import annotations

from stiffopt.cli.base import app

_NO_COMPILER_NOTE = "solves take three to seven times as long (same results)."


@app.command
def cache(*, clear: bool = False) -> int:
    """Show or clear the user's cache of compiled functions.

    Functions are compiled in the background of a solve and used by later solves of the same kind,
    with the same result. STIFFOPT_COMPILE=never disables it, STIFFOPT_CACHE sets the folder.

    Parameters
    ----------
    clear
        Remove them all.
    """
    from stiffopt import compiler

    folder, found = compiler.cache_folder(), compiler.libraries()
    size = sum(path.stat().st_size for path in found) / 1e6
    held = f"{len(found)} compiled functions, {size:.1f} MB, in {folder}"
    if clear:
        compiler.clear()
        print(f"Removed {held}")
        return 0
    print(held)
    program = compiler.compiler()
    if program is None:
        print(f"C compiler: none; {_NO_COMPILER_NOTE}")
    elif compiler.compiles(program):
        print(f"C compiler: {program}")
    else:
        print(f"C compiler: {program} makes no library; {_NO_COMPILER_NOTE} CC names another.")
    return 0
