"""needlehoop: which cameras does a surgical robot need to learn a task?"""

__version__ = "0.1.0"
