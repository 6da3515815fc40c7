"""Stages of the presets: what is computed, kept and read again."""
