"""The evaluation of the gate detector.

setup         the detector as it flies, from a configuration folder
flown_poses   poses of recorded races for rendered images
evaluate      recall and precision in rendered images that the training has not seen
report        its result as table and pictures
image_scores  recall, precision and pose error on labelled images
image_report  their result as table and picture
"""
