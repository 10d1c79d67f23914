"""The ``needlehoop`` command, a file for each group of commands.

A command imports what it needs when it runs.
"""
