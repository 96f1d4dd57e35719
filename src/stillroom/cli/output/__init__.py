"""How commands speak: on stdout what was asked for, on stderr all else."""
