"""What geraf2 does, as functions: the command line, Python, benchmarks and clusters call these."""
