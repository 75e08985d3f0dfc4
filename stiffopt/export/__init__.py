"""Results as files that controllers, simulators and other tools read, one format a file."""
