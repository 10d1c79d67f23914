"""How much is tried of what takes long: a slice in ``make test``, all in ``make test-all``."""

import os

ALL = os.environ.get("NEEDLEHOOP_TEST") == "all"

CRASH_POINTS = int(os.environ.get("CRASH_POINTS", 24 if ALL else 6))
"""Operations on files at which a run is killed, evenly spread."""
