"""Run time and error together, for ours and for the peers that users would otherwise take."""
