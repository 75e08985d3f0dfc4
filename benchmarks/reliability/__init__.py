"""What happens with wrong files, killed processes and full disks, counted: see RELIABILITY.md."""
