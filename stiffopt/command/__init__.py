"""Commands of motors that lead their links, judged on simulated uncertain arms."""
