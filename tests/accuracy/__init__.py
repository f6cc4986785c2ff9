"""The figures of docs/accuracy.md: rendered scenes, their replays, and the measured values.

``make accuracy`` prints required and measured values. The tests in this folder check the computation.
"""
