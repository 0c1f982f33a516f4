"""``driftplan completion``: what a shell needs to complete commands and options."""

from __future__ import annotations

import argparse

from driftplan.report.commands.answer import Answer
from driftplan.report.commands.option import Command, Option

_SCRIPT = """\
_driftplan() {{
  local word=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}}
  local known=
  COMPREPLY=()
  if [ "$COMP_CWORD" = 1 ]; then
    COMPREPLY=($(compgen -W "{commands}" -- "$word"))
    return
  fi
  case "${{COMP_WORDS[1]}} $before" in
{choices}
  esac
  if [ -n "$known" ]; then
    COMPREPLY=($(compgen -W "$known" -- "$word"))
    return
  fi
  case "${{COMP_WORDS[1]}}" in
{options}
  esac
  if [[ "$word" == -* ]]; then
    COMPREPLY=($(compgen -W "$known" -- "$word"))
  else
    local IFS=$'\\n'
    COMPREPLY=($(compgen -f -- "$word"))
  fi
}}
complete -o filenames -F _driftplan driftplan"""


def run(args: argparse.Namespace) -> Answer:
    """The script of a shell, made from the tables of options."""
    from driftplan.report.commands import COMMANDS

    options, choices = [], []
    for name, command in COMMANDS.items():
        flags = [option.flag for option in command.options] + [f"--{kind.replace('_', '-')}" for kind in command.files]
        options.append(f"    {name}) known='{' '.join([*flags, '--json', '--help'])}';;")
        for option in (option for option in command.options if option.choices):
            choices.append(f"    '{name} {option.flag}') known='{' '.join(map(str, option.choices))}';;")
    known = {"options": "\n".join(options), "choices": "\n".join(choices)}
    script = _SCRIPT.format(commands=" ".join(COMMANDS), **known)
    if args.shell == "zsh":
        script = f"autoload -U +X bashcompinit && bashcompinit\n{script}"
    return Answer(payload=lambda: {"shell": args.shell, "script": script}, text=lambda: script)


COMMAND = Command(
    summary="completion of commands and options for bash and zsh",
    description="Print a script that makes a shell complete commands, options, their choices and files: for bash into "
    "~/.local/share/bash-completion/completions/driftplan, for zsh to the end of ~/.zshrc.",
    run=run,
    arguments=(Option("shell", "SHELL", "bash or zsh", str, how={"choices": ("bash", "zsh")}),),
    examples=("bash", "zsh"),
)
