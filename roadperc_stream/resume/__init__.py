"""The state of a finished or interrupted replay: what a continued or resumed replay begins with."""
