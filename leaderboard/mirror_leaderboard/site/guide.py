"""The page's short guide to submissions; docs/submission.md is the full one."""

from __future__ import annotations

from typing import Final

GUIDE: Final = """<section id="submit"><h2>How to submit</h2>
<p>A submission is a folder of PNG renders and a <code>manifest.json</code>. If you have the dataset:</p>
<pre tabindex="0">mirror submission new DATASET --protocol static-reconstruction --split novel --out SUBMISSION
# render every file that SUBMISSION/views.json lists; fill in manifest.json
mirror submission check DATASET SUBMISSION
mirror evaluate DATASET SUBMISSION --protocol static-reconstruction --split novel --out RESULT
mirror leaderboard add RESULT/result.json DATASET --dataset-name NAME --submission SUBMISSION
mirror leaderboard build --out site</pre>
<p>If you do not have it, ask the organiser for the bundle that <code>mirror submission new --blind</code> writes:
poses, lenses, names, sizes and masks, but no images. Send back the renders.</p>
<p>All measured entries of a table have the same protocol, split and dataset, identified by their hashes.
An unavailable figure (such as one without weights) is n/a with its reason, never a zero.</p></section>
"""
