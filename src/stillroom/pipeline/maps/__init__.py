"""Maps on disk, as runs use them."""
