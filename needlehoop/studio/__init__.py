"""A page in the browser: place cameras, see what the agent sees, watch it act."""
