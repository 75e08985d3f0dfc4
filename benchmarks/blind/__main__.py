"""`python -m benchmarks.blind`."""

from .cli import main

raise SystemExit(main())
