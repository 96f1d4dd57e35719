"""Who may move: boxes and masks of people and other things with a will of their own."""
