"""What is said of a verdict: where the model misses, words, the answer as JSON, saved fits, the next test."""
