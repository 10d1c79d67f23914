"""Tables, the report's page, and where a study stands."""
