"""What the calls of ``import needlehoop`` do: environments from names or runs, policies from runs.

Nothing of a command line, and nothing that trains.
"""
