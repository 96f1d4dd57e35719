"""Many runs: sequence × method × setting × seed, on this machine's cores or on a cluster, with one row for each run."""
