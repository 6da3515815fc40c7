"""Reconstruction while the scan is made: a session of planes, and folders that grow."""
