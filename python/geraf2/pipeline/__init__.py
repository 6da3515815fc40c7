"""The jobs of geraf2 as functions: the command line, Python, benchmarks and clusters call these."""
