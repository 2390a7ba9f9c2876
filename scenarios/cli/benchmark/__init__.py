"""Commands of the benchmark, heft benchmark and heft score: arguments and printed results; all else is elsewhere."""
