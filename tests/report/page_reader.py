"""Parser of a page for tests: text, tags, tables and external requests."""

import re
from html.parser import HTMLParser

__all__ = ["Page"]

VOID = {"meta", "br", "link", "img", "hr", "input"}


class Page(HTMLParser):
    """Reads a page and checks that its tags are balanced.

    `tables` holds a list of rows a table, each a list of texts, the heading first.
    """

    def __init__(self, text):
        super().__init__()
        self.open, self.words, self.outside, self.tags, self.tables = [], [], [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append("")
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "data") and not value.startswith("#"):
                self.outside.append(value)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)
        if "td" in self.open or "th" in self.open:
            self.tables[-1][-1][-1] += data

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.words))

    def table(self, *headings):
        """Rows of the first table whose heading begins so."""
        return next(t for t in self.tables if tuple(t[0][: len(headings)]) == headings)[1:]
