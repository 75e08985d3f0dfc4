"""Unit names as loggers write them."""

# Names of loggers and their names in `[signals.scale]`; "" is SI. "A", "%" and "counts" need a
# factor from the user.
UNITS = {
    "deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg", "grad": "deg", "rad": "",
    "mrad": "mrad", "rev": "turn", "revs": "turn", "turn": "turn", "turns": "turn", "u": "turn",
    "deg/s": "deg/s", "°/s": "deg/s", "rad/s": "", "mrad/s": "mrad/s", "rpm": "rpm",
    "1/min": "rpm", "min-1": "rpm", "u/min": "rpm", "nm": "", "n m": "", "n*m": "", "n.m": "",
    "n-m": "", "n·m": "", "mnm": "mN*m", "knm": "kN*m", "ncm": "N*cm", "a": "A", "ma": "mA",
    "arms": "A", "%": "%", "percent": "%", "inc": "counts", "incs": "counts", "cts": "counts",
    "counts": "counts", "ticks": "counts", "ms": "ms", "msec": "ms", "us": "us", "µs": "us",
    "ns": "ns", "s": "", "sec": "", "m": "", "mm": "mm", "cm": "cm", "mm/s": "mm/s", "m/s": "",
    "n": "", "kn": "kN", "-": "",
}  # fmt: skip
