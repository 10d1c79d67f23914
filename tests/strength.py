"""How much is tried of what takes long: a slice in ``make test``, all in ``make test-all``."""

import os

ALL = os.environ.get("NEEDLEHOOP_TEST") == "all"
