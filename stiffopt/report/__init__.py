"""What people look at: pages with figures, and the progress of a solve in the terminal.

The only package that knows matplotlib and Jinja. A room a report: `page.html.j2` holds its
sections, tables and captions, `page.py` the numbers for them, `figures.py` the drawings,
`terminal.py` what the command prints. How a number is written is decided by the filters of
`common/text.py`, how a table or figure stands on a page by the macros of `common/macros.html.j2`.
"""
