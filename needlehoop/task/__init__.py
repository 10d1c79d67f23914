"""The task: where episodes begin, what actions do, which facts hold. No physics, no pay."""
