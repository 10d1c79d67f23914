"""Tasks: what stands in the scene, where episodes begin, what is true, who can do it.

One folder a task, behind ``contract.Task``; ``registry`` finds them by name. Files beside the
folders are what tasks with the PSM share: its control, its start, the settings of an episode.
"""
