"""What does move: the sieves."""
