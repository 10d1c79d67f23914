"""Train an agent to thread the needle: ``python train.py cams=dep_front,seg_side reward=human``.

The method is on one page, ``needlehoop/train.py``. ``needlehoop train`` is the same command, for
an install without this file. ``--help`` lists the settings.
"""

import sys

from needlehoop.cli.train import run

if __name__ == "__main__":
    run(sys.argv[1:], "python train.py")
