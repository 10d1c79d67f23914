"""Runs as files: folders, names, provenance, signals. No simulator and no agent."""
