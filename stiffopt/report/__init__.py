"""Reports as HTML pages with figures, and the output of commands in the terminal.

The only package that imports matplotlib and Jinja. Of each report `page.html.j2` has the sections,
tables and captions, `page.py` their numbers, `figures.py` the figures, `terminal.py` the
output of the command. The filters of `common/text.py` format numbers, the macros of
`common/macros.html.j2` tables and figures.
"""
