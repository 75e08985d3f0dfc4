"""Sphinx directive `command-reference`: the help of every command, as the program prints it."""

import contextlib
import io

from docutils import nodes
from docutils.parsers.rst import Directive


def _help_text(app, tokens):
    from rich.console import Console

    stream = io.StringIO()
    with contextlib.suppress(SystemExit):
        app.help_print(tokens, console=Console(file=stream, width=76, color_system=None))
    return stream.getvalue().rstrip()


class CommandReference(Directive):
    """One section with the help text of each command."""

    def run(self):
        from stiffopt.cli import app

        sections = []
        for name in sorted(name for name in app if not name.startswith("-")):
            section = nodes.section(ids=[f"command-{name}"])
            section += nodes.title(text=f"stiffopt {name}")
            section += nodes.literal_block(text=_help_text(app, [name]), language="text")
            for inner in (inner for inner in app[name] if not inner.startswith("-")):
                text = _help_text(app, [name, inner])
                section += nodes.literal_block(text=text, language="text")
            sections.append(section)
        return sections


def setup(app):
    app.add_directive("command-reference", CommandReference)
    return {"parallel_read_safe": True}
