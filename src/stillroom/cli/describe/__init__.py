"""Commands that only tell what there is."""
