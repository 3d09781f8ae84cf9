"""`canopen completion`: the script that makes a shell complete commands, options, buses, nodes, objects and constants."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from canopen_cli.completion.words import VARIABLE, script
from canopen_cli.shared.problem import usage

SHELLS = {"bash": "bash", "zsh": "zsh", "fish": "fish", "pwsh": "powershell"}
"""The shells, and click's names for them."""


@click.command()
@click.argument("shell", metavar="{bash|zsh|fish|pwsh}", type=click.Choice(list(SHELLS)))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Write the script by which a shell completes commands, nodes, objects and constants.

    \b
    bash   canopen completion bash > ~/.local/share/bash-completion/completions/canopen
    zsh    canopen completion zsh > ~/.zfunc/_canopen        with fpath+=~/.zfunc before compinit
    fish   canopen completion fish > ~/.config/fish/completions/canopen.fish
    pwsh   canopen completion pwsh >> $PROFILE

    Names of objects are those of the line's files (-e, -m), else those of the data files.
    """
    kind = get_completion_class(SHELLS[shell])
    if kind is None:
        raise usage("CO141", f"the installed click has no completion for {shell}", tries=("pip install -U click",))
    click.echo(script(kind(context.find_root().command, {}, "canopen", VARIABLE)), nl=False)
