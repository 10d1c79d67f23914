"""Tasks: what stands in the scene, where episodes begin, what is true, who can do it.

One folder a task, behind ``contract.Task``; ``registry`` finds them by name. Files beside the
folders are what tasks with the PSM share: its control, its start, the settings of an episode.
"""

from pkgutil import iter_modules


def built_in() -> tuple[str, ...]:
    """Names of the tasks of this package; imports none."""
    return tuple(sorted(one.name for one in iter_modules(__path__) if one.ispkg))
