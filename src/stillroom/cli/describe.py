"""`stillroom methods`."""

import typer

from stillroom.cli.arguments import ConfigFile, Method, Seed, Settings

# `stillroom methods`.


def methods() -> None:
    """List the methods."""
    from stillroom.cli.output import print_table
    from stillroom.config.kinds import DYNAMICS, SEMANTICS
    from stillroom.presets.registry import all_methods

    rows = []
    for method in all_methods().values():
        config = method.config
        kinds = SEMANTICS.name_of(config.semantics), DYNAMICS.name_of(config.dynamics)
        rows.append((method.name, *kinds, method.summary, method.paper))
    print_table(("method", "what may move", "what does move", "in words", "published"), rows, n_words=5)


# `stillroom show-config`.


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
    from stillroom.presets.registry import configure

    typer.echo(to_toml(configure(method, config, settings or (), seed)), nl=False)
