"""Interactive view of runs and scenes in a browser, served by this machine."""
