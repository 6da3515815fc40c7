"""Command line; the only package with print and exit. One file a subcommand.

Each subcommand is a module with a frozen dataclass `Config`, whose fields are its flags, and
`main(config) -> int`, which tests call. Modules are imported only when their command is used,
so that `geraf2 --help` is quick.
"""
