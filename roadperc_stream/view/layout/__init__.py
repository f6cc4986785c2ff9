"""The layout that Foxglove and Lichtblick open: panels for what one log has, and no others."""
