"""Diagnosis of recordings: physics that the nominal model lacks, its parameters and its proof."""
