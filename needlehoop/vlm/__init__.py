"""Questions to a vision-language model, its rankings and the rewards that it writes."""
