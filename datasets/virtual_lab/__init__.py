"""A laboratory that knows nothing of our model: it makes recordings whose causes are known.

``campaign.draw_campaign`` is the way in; ``stage.record`` is the bench; ``truths`` holds the
ceramics and ``effects`` what goes wrong with them.
"""
