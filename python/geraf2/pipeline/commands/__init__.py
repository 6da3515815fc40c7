"""One function for each command; the command line, Python, benchmarks and clusters call these."""
