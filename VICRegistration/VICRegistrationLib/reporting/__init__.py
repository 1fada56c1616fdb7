"""One page with everything about fitted organs, for people: no script, nothing outside of the file."""
