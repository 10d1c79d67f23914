"""The ``needlehoop`` command, a file for each group of commands.

A command imports what it needs when it runs; what takes seconds to import (the simulator, the
agent), once it knows that it is asked for nothing wrong.
"""
