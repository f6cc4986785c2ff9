"""The same loop over many logs: processes on this machine, or Ray across machines, into one dataset."""
