"""What lies in a folder, to compare it before and after a command."""


def contents(folder):
    """Bytes of each file below a folder."""
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
