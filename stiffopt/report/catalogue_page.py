"""The page of the catalogue, `.github/catalogue.md`: one line an effect, from the effects alone.

``python -m stiffopt.report.catalogue_page > .github/catalogue.md`` writes it anew.
"""

from __future__ import annotations

from collections.abc import Sequence

from stiffopt.discovery.catalogue import CATALOGUE, confused_with
from stiffopt.discovery.effect import Effect, Need
from stiffopt.discovery.identifiable import required_signals

_HEAD = """# Catalogue of effects

What `stiffopt diagnose` can name, one line an effect. An effect is located at a joint, a link, a
run or the robot as a whole (scope). In equations: motor angle th, speed w, link angle q and
velocity v (angles of the motor through the ratio), torque in the spring s, drive torque tau,
wind-up D(s), and d for motor less link angle; sg is a sign that is smooth within 0.01 rad/s. All
SI. Needs are those of a joint at which it is to be found; what it is easily taken for asks for a
motion that separates them; `stiffopt solve --model` plans with those marked "yes". Written by
`stiffopt.report.catalogue_page`.

| effect | family | scope | equation | how it shows | needs | taken for | planned with | source |
|---|---|---|---|---|---|---|---|---|
"""
_NEEDS: dict[Need, str] = {
    "torque": "torque",
    "link": "link encoder",
    "sensor": "torque or link encoder",
    "windup": "link encoder, or links that swing",
    "moves": "motion",
    "reverses": "both directions",
    "slow": "slow motion",
    "speeds": "several speeds",
    "load_changes_sign": "load on both sides",
    "rotor_slow": "slow turns of the rotor",
    "ripple_slow": "slow turns of the motor's poles",
    "warmer": "cold and warm runs",
    "gear_ratio": "gear ratio",
    "pole_pairs": "pole pairs",
    "tool_frame": "tool frame",
    "before": "a joint before it",
    "runs": "several runs",
    "three_runs": "three runs",
}


def catalogue_page(effects: Sequence[Effect] = CATALOGUE) -> str:
    """Markdown of the page."""
    return _HEAD + "".join(f"| {' | '.join(_cells(each, effects))} |\n" for each in effects)


def _cells(effect: Effect, effects: Sequence[Effect]) -> tuple[str, ...]:
    return (
        f"`{effect.name}`",
        effect.family,
        effect.scope,
        f"`{effect.equation}`",
        effect.signature,
        ", ".join(_NEEDS[need] for need in required_signals(effect)),
        ", ".join(f"`{name}`" for name in confused_with(effect, effects)),
        "yes" if effect.change_robot else "",
        effect.reference,
    )


if __name__ == "__main__":
    print(catalogue_page(), end="")
