"""Accuracy and timings beside truth and peers; not part of the installed package."""
