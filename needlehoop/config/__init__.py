"""Settings from YAML and the command line: composed, then checked by type. No simulator."""
