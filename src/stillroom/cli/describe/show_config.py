"""`stillroom show-config`."""

import typer

from stillroom.cli.arguments import ConfigFile, Method, Seed, Settings


def show_config(
    method: Method = None,
    config: ConfigFile = None,
    settings: Settings = None,
    seed: Seed = None,
) -> None:
    """Print the configuration of a method as TOML.

    Each value is one that --set can change; a file with some of them is what --config takes.
    """
    from stillroom.config import to_toml
    from stillroom.methods.registry import configure

    typer.echo(to_toml(configure(method, config, settings or (), seed)), nl=False)
