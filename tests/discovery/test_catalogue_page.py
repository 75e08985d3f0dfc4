"""The page of the catalogue says what the catalogue says."""

from small_arms import ROOT

from stiffopt.discovery.catalogue import CATALOGUE

PAGE = ROOT / ".github" / "catalogue.md"


def row(effect):
    """Line of the page for an effect."""
    cells = (
        f"`{effect.name}`",
        effect.family,
        effect.scope,
        f"`{effect.equation}`",
        effect.signature,
    )
    assert not any("|" in cell for cell in cells)
    return f"| {' | '.join(cells)} |"


def test_every_effect_has_its_line():
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    begin = lines.index("|---|---|---|---|---|") + 1
    assert lines[begin:] == [row(effect) for effect in CATALOGUE]
