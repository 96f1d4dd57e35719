"""Making a vocabulary of places from sequences."""
