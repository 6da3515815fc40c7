"""Functions for the jobs of geraf2, called by command line, Python, benchmarks and clusters."""
