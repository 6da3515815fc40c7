"""What a command printed on the terminal."""


def the_error(capsys):
    """Its one line of error."""
    lines = [x for x in capsys.readouterr().err.splitlines() if x.startswith("geraf2:")]
    assert len(lines) == 1
    return lines[0]
