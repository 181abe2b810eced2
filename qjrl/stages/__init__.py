"""One thin file a stage: what it is configured by, what it reads and writes. No mathematics."""
