"""`geraf2 completion`: completion of commands, flags and their choices in a shell."""

import importlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from geraf2._bounds import Arg
from geraf2.apps.importers import importer_names
from geraf2.cli._commands import COMMANDS, GLOBAL_FLAGS, VALUE_FLAGS
from geraf2.cli._console import out
from geraf2.cli._fields import Flag, Positional, walk
from geraf2.pipeline.presets import PRESETS

_BASH = """\
_geraf2() {{
  local cur=${{COMP_WORDS[COMP_CWORD]}} prev=${{COMP_WORDS[COMP_CWORD-1]}} command= word words=
  for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
    case $word in {commands}) command=$word; break;; esac
  done
  case $command in
    "") words="{all_commands}";;
{flags}
  esac
  case "$command $prev" in
{choices}
  esac
  if [[ $cur == -* || -z $command || $words != *--* ]]; then
    COMPREPLY=($(compgen -W "$words" -- "$cur"))
  else
    compopt -o filenames 2>/dev/null
    COMPREPLY=($(compgen -f -- "$cur"))
  fi
}}
complete -F _geraf2 geraf2
"""
# Choices of flags that take any text.
_NAMES = {"preset": PRESETS, "help_preset": PRESETS, "format": importer_names()}
_ZSH = "#compdef geraf2\nautoload -U +X bashcompinit && bashcompinit\n"


@dataclass(frozen=True, kw_only=True)
class Config:
    """Print what completes commands, flags and choices in a shell.

    bash: eval "$(geraf2 completion bash)". zsh: the same with zsh. fish: geraf2 completion fish |
    source. Put the line into the file that the shell reads at its start.
    """

    shell: Positional[Annotated[Literal["bash", "zsh", "fish"], Arg(metavar="SHELL")]]
    """bash, zsh or fish."""


def main(config: Config) -> int:
    """Run the command."""
    out.print({"bash": _bash, "zsh": lambda: _ZSH + _bash(), "fish": _fish}[config.shell](), end="")
    return 0


def _flags(command: str) -> Iterator[tuple[Flag, tuple[str, ...]]]:
    """Yield the flags of a command that its help shows, each with the words to choose from."""
    module = importlib.import_module(f"geraf2.cli.{COMMANDS[command].module}")
    for flag in walk(module.Config, {}):
        if flag.hidden or flag.is_fixed:
            continue
        choices = flag.kinds[0] if isinstance(flag.kinds[0], tuple) else ()
        yield flag, tuple(_NAMES.get(flag.path[-1], choices) if flag.kinds == (str,) else choices)


def _bash() -> str:
    flags, choices = [], []
    for command in COMMANDS:
        found = list(_flags(command))
        names = [flag.name for flag, _ in found if not flag.in_place]
        flags.append(f'    {command}) words="{" ".join([*names, *GLOBAL_FLAGS, *VALUE_FLAGS])}";;')
        for flag, words in found:
            before = command if flag.in_place else flag.name
            if words:
                choices.append(f'    "{command} {before}") words="{" ".join(words)}";;')
    return _BASH.format(
        commands="|".join(COMMANDS),
        all_commands=" ".join([*COMMANDS, *GLOBAL_FLAGS, *VALUE_FLAGS]),
        flags="\n".join(flags),
        choices="\n".join(choices),
    )


def _fish() -> str:
    none = f"not __fish_seen_subcommand_from {' '.join(COMMANDS)}"
    lines = []
    for name, command in COMMANDS.items():
        lines.append(f"complete -c geraf2 -f -n '{none}' -a {name} -d '{command.summary}'")
        for flag, words in _flags(name):
            when = f"-n '__fish_seen_subcommand_from {name}'"
            what = f"-xa '{' '.join(words)}'" if words else "-r" if flag.counts[1] else ""
            if not flag.in_place:
                lines.append(f"complete -c geraf2 {when} -l {flag.name[2:]} {what}".rstrip())
            elif words:
                lines.append(f"complete -c geraf2 {when} {what}")
    lines += [f"complete -c geraf2 -l {flag[2:]}" for flag in GLOBAL_FLAGS]
    lines += [f"complete -c geraf2 -l {flag[2:]} -r" for flag in VALUE_FLAGS]
    return "\n".join(lines) + "\n"
