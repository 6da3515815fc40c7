"""Command line; the only room with print and exit. One file a subcommand."""
