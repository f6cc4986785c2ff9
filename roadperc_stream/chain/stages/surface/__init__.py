"""The drivable surface: a plane through the road's points, a height field beside it, and the pixels that lie on it."""
