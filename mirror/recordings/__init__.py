"""Fleet recordings: one file per format, all behind the protocol of `mirror.recordings.protocol`."""
