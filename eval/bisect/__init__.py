"""The shortest excerpt and the fewest settings for which a criterion still fails."""
