"""Episodes for other learners: who demonstrates, and the layouts of the datasets."""
