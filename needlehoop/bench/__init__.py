"""How fast this machine is: the environment, training, and Stable-Baselines3 beside them."""
