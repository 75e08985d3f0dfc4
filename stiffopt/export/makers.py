"""Makers of arms by the names of their models: programs go to the maker's controller only."""

from __future__ import annotations

import re

# Maker to the pattern of the model's name: series letters before a digit, or the maker itself.
_MODEL_PATTERNS = {
    "Universal Robots": r"ur\d|universal.?robots",
    "KUKA": r"kuka|kr\W?\d|lbr\b|iiwa",
    "ABB": r"abb\b|irb|crb\W?\d|gofa|yumi",
    "Fanuc": r"fanuc|lr\W?mate|crx\W?\d|m\W?\d+i[abcd]|r\W?2000",
    "EFORT": r"efort|er\d",
    "Yaskawa": r"yaskawa|motoman|gp\d|hc\d",
    "Staubli": r"st[äa]e?ubli|tx2?\W?\d",
    "Franka": r"franka|panda|fr3\b",
}


def maker_of(name: str) -> str:
    """Maker of an arm by its name; "" where it is not known.

    >>> maker_of("ur10"), maker_of("kuka_kr6_r900"), maker_of("my_arm")
    ('Universal Robots', 'KUKA', '')
    """
    for maker, pattern in _MODEL_PATTERNS.items():
        if re.search(rf"(?:^|[\W_])(?:{pattern})", name.lower()):
            return maker
    return ""
