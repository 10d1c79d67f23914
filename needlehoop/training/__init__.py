"""A training from the command line to its files: options, which run is meant, the loop, sweeps."""
