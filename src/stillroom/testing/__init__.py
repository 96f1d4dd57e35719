"""The contracts of the sockets: conformance tests for your own data set, segmenter, sieve or method."""
