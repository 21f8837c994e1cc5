"""Writers of the public formats, one file a format; all write the same drives, those of `street`."""
