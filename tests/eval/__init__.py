"""Tests of what reads finished outputs."""
