"""Simulated walks: record, replay, score, film."""
