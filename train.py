"""Train an agent to thread the needle: ``python train.py cams=dep_front,seg_side reward=human``.

The method is on one page, ``needlehoop/training/loop.py``. ``needlehoop train`` is the same
command, for an install without this file. ``--help`` lists the settings.
"""

import sys

if __name__ == "__main__":
    try:
        from needlehoop.cli.train import run

        run(sys.argv[1:], "python train.py")
    except KeyboardInterrupt:
        sys.exit("train.py: stopped")
