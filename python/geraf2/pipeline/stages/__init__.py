"""Stages of the presets: computation, storage and reading of results."""
