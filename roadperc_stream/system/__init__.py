"""What the operating system gives: files, processes, threads, memory, times, progress, lines of text."""
