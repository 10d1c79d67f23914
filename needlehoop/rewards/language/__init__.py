"""The language of reward programs: from text to torch calls. Nothing of files or models."""
