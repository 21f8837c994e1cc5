"""How to submit, as the page says it; docs/submission.md says it at length."""

from __future__ import annotations

from typing import Final

GUIDE: Final = """<section id="submit"><h2>How to submit</h2>
<p>A submission is a folder of PNG renders and a <code>manifest.json</code>. With the data set at hand:</p>
<pre tabindex="0">mirror submission new DATASET --protocol static-reconstruction --split novel --out SUBMISSION
# render every file that SUBMISSION/views.json lists; fill in manifest.json
mirror submission check DATASET SUBMISSION
mirror evaluate DATASET SUBMISSION --protocol static-reconstruction --split novel --out RESULT
mirror leaderboard add RESULT/result.json --dataset-name NAME
mirror leaderboard build --out site</pre>
<p>Without it, ask its keeper for the bundle that <code>mirror submission new --blind</code> writes: poses, lenses,
names, sizes and masks, but no pictures. Send back the renders.</p>
<p>A table holds only what was scored by one protocol on one split of one data set, told by their hashes.
A figure that could not be had (weights that were not there) is n/a with its reason, never a zero.</p></section>
"""
