"""The agent, how it learns, how a run is evaluated. Knows no command line."""
