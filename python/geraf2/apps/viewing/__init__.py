"""Runs and scenes live in a browser: layers, slices, planes, served by viser."""
