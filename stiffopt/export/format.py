"""Interface and registry of motion formats, with the header that identifies an exported motion."""

from __future__ import annotations

import hashlib
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from stiffopt.errors import InputError
from stiffopt.export.motion import MotionEvent, SampledMotion, StoredMotion, check_rate
from stiffopt.problem.registry import Registry


class ExportFormat(ABC):
    """Format of an exported motion."""

    name: str  # name for `--to`
    title: str  # reader of the format
    rate: float  # default rate [Hz]
    rate_max: float  # largest rate [Hz]
    whole_steps = False  # True for a fixed cycle: every step is 1/rate
    # True if its programs approach the start and stop at the end, so that the motion must start and
    # end at rest.
    from_rest = False
    maker = ""  # maker of the arms that run its programs; "" for any

    def export(self, stored: StoredMotion, rate: float | None = None) -> dict[str, str]:
        """Export a motion as texts by file name.

        Parameters
        ----------
        rate : float, optional [Hz]

        Raises
        ------
        InputError
            Rate, joints or positions are outside the range of the format, or the samples exceed a
            limit.
        """
        chosen = self.rate if rate is None else rate
        check_rate(chosen, self.rate_max, self.title)
        require_maker(stored.problem.robot.name, self)
        self.check(stored, chosen)
        if self.from_rest:
            stored.require_rest(self.title)
        motion = self.sample(stored, chosen)
        stored.judge(motion)
        texts = {
            name: with_seal(text, seal_entries(stored, self.name, chosen, name), name)
            for name, text in self.files(motion, chosen).items()
        }
        return texts | self.programs(texts)

    def sample(self, stored: StoredMotion, rate: float) -> SampledMotion:
        """Sample a motion as the format needs it."""
        return stored.sampled(rate, whole_steps=self.whole_steps)

    def with_pulses(self, pulses: Sequence[float]) -> ExportFormat:
        """Return the format with pulses per degree of each axis; `InputError` if it has none."""
        raise InputError(f"--pulses: {self.title} takes no pulses. Leave it out.")

    def check(self, stored: StoredMotion, rate: float) -> None:  # noqa: B027
        """Raise `InputError` for motions outside the range of the format."""

    @abstractmethod
    def files(self, motion: SampledMotion, rate: float) -> dict[str, str]:
        """Texts by file name, of a motion sampled at `rate` [Hz]."""

    def programs(self, texts: dict[str, str]) -> dict[str, str]:
        """Texts of programs that send the files, by file name."""
        return {}


class CyclicFormat(ExportFormat):
    """Format whose program approaches the start and follows one row in each controller cycle.

    For arms of six revolute joints; `rate_max` is that of the controller's shortest cycle.
    """

    whole_steps = True
    from_rest = True

    def check(self, stored: StoredMotion, rate: float) -> None:
        """Require six revolute joints and a whole number of cycles."""
        require_six_axes(stored, self.title)
        require_cycle(rate, self.rate_max, self.title)


@dataclass(frozen=True, kw_only=True)
class PointStep:
    """Step of a program of points: a move, a rest or an event."""

    sample: int = 0  # sample that a move goes to
    speed: float = 0.0  # share of the joints' largest velocities [%]; 0 for a rest or an event
    stop: bool = False  # True where a move comes to rest
    rest: float = 0.0  # duration of a rest [s]
    event: MotionEvent | None = None


class PointFormat(ExportFormat):
    """Format of programs whose controller times the motion itself, from points and speeds.

    For arms of six revolute joints. A speed is the share of the velocity limit that the fastest
    joint needs to reach the next point in time.
    """

    rate = 20.0
    rate_max = 100.0
    from_rest = True
    # Lines of at most 32 characters, the length of a comment in a job.
    remarks = (
        "Joint signs and zeros are of the",
        "URDF: compare before the 1st run",
        "Speeds: % of the joint velocity",
        "limits of the robot file.",
        "NOT kept, the controller decides",
        "them: duration, acceleration,",
        "jerk, torque, error limits.",
    )

    def sample(self, stored: StoredMotion, rate: float) -> SampledMotion:
        """Sample a motion at the rate and at its events, where the arm stops."""
        return stored.sampled(rate, at_events=True)

    def check(self, stored: StoredMotion, rate: float) -> None:
        """Require six revolute joints with velocity limits."""
        require_six_axes(stored, self.title)
        limits = stored.problem.robot.velocity_max
        for j in np.flatnonzero(~np.isfinite(limits)):
            raise InputError(
                f"joint {j + 1} ({stored.joint_names[j]}) has no velocity limit in the robot file, "
                f"and speeds of {self.title} are shares of it. Add velocity_max there and solve "
                "again, or export with --to csv."
            )

    def steps(self, motion: SampledMotion) -> list[PointStep]:
        """Moves, rests and events after the approach to the first sample."""
        change = np.abs(np.diff(motion.position, axis=0))
        step = np.diff(motion.time)
        share = np.max(change / motion.velocity_max, axis=1) / step
        # Smaller steps [rad] than a pulse are a rest.
        moves = np.append(np.max(change, axis=1) > 1e-5, False)
        found: list[PointStep] = []
        rest = 0.0
        for k in range(1, len(motion.time)):
            events = motion.events_until(k)
            if moves[k - 1]:
                if rest:
                    found.append(PointStep(rest=rest))
                    rest = 0.0
                # Lowest speed [%] of a point to point move in both languages.
                speed = float(np.clip(100.0 * share[k - 1], 0.01, 100.0))
                stop = bool(events) or not moves[k]
                found.append(PointStep(sample=k, speed=speed, stop=stop))
            else:
                rest += float(step[k - 1])
            if events and rest:
                found.append(PointStep(rest=rest))
                rest = 0.0
            found += [PointStep(event=event) for event in events]
        return [*found, PointStep(rest=rest)] if rest else found


def identifier(title: str, length: int) -> str:
    """Name of letters, digits and underscores, of at most `length` of them, from a title."""
    return re.sub(r"\W", "_", title.lower(), flags=re.ASCII).strip("_")[:length]


def rows_text(names: Iterable[str], rows: Iterable[Sequence[float]]) -> str:
    """CSV of rows with six decimals below a head."""
    lines = [",".join(f"{value:.6f}" for value in row) for row in rows]
    return "\n".join([",".join(names), *lines]) + "\n"


FORMATS: Registry[ExportFormat] = Registry("stiffopt.export.formats")


# Lines of KRL sources are of ASCII and below 256 characters: one entry a line.
_ENTRY_PATTERN = re.compile(r"^(?:[#;!]|<!--) stiffopt (\w+): (.*?)(?: -->)?\n", re.MULTILINE)
# Start and end of a comment by suffix, and the number of lines before the header.
_XML_COMMENT = ("<!--", " -->", 1)
_COMMENT_STYLES = {
    ".src": (";", "", 2),
    ".mod": ("!", "", 1),
    **dict.fromkeys((".pjx", ".pgx", ".dtx"), _XML_COMMENT),
}
# Files whose format has no comments of this length.
UNSEALED_SUFFIXES = (".ls", ".JBI")


def seal_entries(stored: StoredMotion, to: str, rate: float, file: str) -> dict[str, str]:
    """Entries of a file's header: motion, hashes and sampling."""
    return {
        "file": file,
        "format": to,
        "of": stored.which,
        "rate": repr(float(rate)),
        **stored.seal,
    }


def with_seal(text: str, entries: dict[str, str], file: str) -> str:
    """Add the header, which includes the hash of all other lines."""
    if PurePath(file).suffix in UNSEALED_SUFFIXES:
        return text
    mark, close, before = _COMMENT_STYLES.get(PurePath(file).suffix, ("#", "", 0))
    # Hash the text as `read_seal` returns it: a title may look like an entry.
    content = hashlib.sha256(_ENTRY_PATTERN.sub("", text).encode()).hexdigest()
    lines = text.splitlines(keepends=True)
    header = [
        f"{mark} stiffopt {key}: {value}{close}\n"
        for key, value in {**entries, "content": content}.items()
    ]
    return "".join([*lines[:before], *header, *lines[before:]])


def read_seal(text: str) -> tuple[dict[str, str], str]:
    """Split a file into the entries of its header and the remaining text."""
    return dict(reversed(_ENTRY_PATTERN.findall(text))), _ENTRY_PATTERN.sub("", text)


def is_whole(entries: dict[str, str], body: str) -> bool:
    """Return True if the text has the hash of its header."""
    return entries.get("content") == hashlib.sha256(body.encode()).hexdigest()


def require_maker(robot: str, form: ExportFormat) -> None:
    """Raise `InputError` for an arm of another maker than that of the format's programs."""
    known = maker_of(robot)
    if form.maker and known and known != form.maker:
        fitting = [name for name, each in FORMATS.items() if each.maker in ("", known)]
        raise InputError(
            f"--to {form.name}: {form.title} programs run on arms of {form.maker}; {robot} is one "
            f"of {known}. Export it with --to {' or '.join(sorted(fitting))}."
        )


def require_six_axes(stored: StoredMotion, owner: str) -> None:
    """Raise `InputError` unless the arm has six revolute joints."""
    slides = int(np.sum(stored.prismatic))
    if len(stored.joint_names) != 6 or slides:
        those = f", {slides} of them sliding" if slides else ""
        raise InputError(
            f"{owner} moves arms of 6 turning joints; this motion has "
            f"{len(stored.joint_names)} joints{those}. Export it with --to ros2 or csv."
        )


def require_cycle(rate: float, fastest: float, owner: str) -> None:
    """Raise `InputError` unless 1/rate is a whole number of controller cycles."""
    cycles = fastest / rate
    if abs(cycles - round(cycles)) > 1e-6 * cycles:
        allowed = ", ".join(f"{fastest / k:g}" for k in (1, 2, 4, 5))
        raise InputError(
            f"--rate {rate:g} Hz: {owner} has a cycle of {1e3 / fastest:g} ms, so the rate must be "
            f"{fastest:g} Hz divided by a whole number, such as {allowed}."
        )


# Maker to the pattern of the model's name: series letters before a digit, or the maker itself.
_MODEL_PATTERNS = {
    "Universal Robots": r"ur\d|universal.?robots",
    "KUKA": r"kuka|kr\W?\d|lbr\b|iiwa",
    "ABB": r"abb\b|irb|crb\W?\d|gofa|yumi",
    "Fanuc": r"fanuc|lr\W?mate|crx\W?\d|m\W?\d+i[abcd]|r\W?2000",
    "EFORT": r"efort|er\d",
    "Yaskawa": r"yaskawa|motoman|gp\d|hc\d|mh\d",
    "Staubli": r"st[äa]e?ubli|[rt]x2?[\W_]?\d{2}|ts2[\W_]?\d{2}",
    "Franka": r"franka|panda|fr3\b",
    "Kawasaki": r"kawasaki|rs\d{3}",
    "Mitsubishi": r"mitsubishi|rv\W?\d+f",
    "Denso": r"denso|cobotta|vs\W?\d{3}",
    "Doosan": r"doosan",
    "Techman": r"techman|tm\d{1,2}\b",
    "Comau": r"comau",
    "Kinova": r"kinova|jaco|j2[ns]\d|gen3\b",
    "UFACTORY": r"ufactory|xarm\d?|lite\W?6",
    "Rethink": r"sawyer|baxter",
}


def maker_of(name: str) -> str:
    """Maker of an arm by its name; "" where it is not known.

    >>> maker_of("ur10"), maker_of("kuka_kr6_r900"), maker_of("rx160"), maker_of("my_arm")
    ('Universal Robots', 'KUKA', 'Staubli', '')
    """
    for maker, pattern in _MODEL_PATTERNS.items():
        if re.search(rf"(?:^|[\W_])(?:{pattern})", name.lower()):
            return maker
    return ""
