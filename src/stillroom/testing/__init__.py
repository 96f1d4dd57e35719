"""The contracts of the sockets, importable: run your own dataset, segmenter or sieve through them in your tests."""
