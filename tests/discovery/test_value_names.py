"""Names of nominal values as they stand in files."""

import pytest

from stiffopt.discovery.names import ValueName


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("coulomb 3", ValueName("coulomb", 2)),
        ("com 2 x", ValueName("com", 1, "x")),
        ("body 12 mx", ValueName("body", 11, "mx")),
        ("rounding T1 4", ValueName("rounding T1", 3)),
    ],
)
def test_names_are_read_as_written(text, name):
    assert ValueName.read(text) == name
    assert str(name) == text


@pytest.mark.parametrize("text", ["coulomb", "coulomb 0", "3 coulomb", "com 2 x y"])
def test_other_words_are_refused(text):
    with pytest.raises(ValueError, match="is no nominal value"):
        ValueName.read(text)
