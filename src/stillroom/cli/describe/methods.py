"""`stillroom methods`."""


def methods() -> None:
    """List the methods."""
    from stillroom.cli.output.tables import print_table
    from stillroom.config.kinds import DYNAMICS, SEMANTICS
    from stillroom.methods.registry import all_methods

    rows = []
    for method in all_methods().values():
        config = method.config
        kinds = SEMANTICS.name_of(config.semantics), DYNAMICS.name_of(config.dynamics)
        rows.append((method.name, *kinds, method.summary, method.paper))
    print_table(("method", "what may move", "what does move", "in words", "published"), rows, n_words=5)
