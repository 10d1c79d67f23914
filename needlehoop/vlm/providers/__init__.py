"""Those who answer: models behind servers. What is asked is made one floor up."""
