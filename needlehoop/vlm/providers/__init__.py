"""Those who answer: models behind servers, or a person with a chat window."""
