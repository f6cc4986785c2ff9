"""The figures of docs/accuracy.md: drives, how they are replayed, and what is measured on them.

``make accuracy`` prints what is required beside what is measured; the tests in this folder are of its own arithmetic.
"""
