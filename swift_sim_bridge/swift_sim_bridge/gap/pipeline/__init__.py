"""The steps of a diagnosis in order.

diagnosis       options and result of a diagnosis
hypotheses      the effects that the recordings can show
references      the reference flights of a recording
prepare         recordings and reference flights as the evidence of a search
single_flight   the diagnosis of one recording
multi_flight    the diagnosis of several recordings of one vehicle together
unseen_flights  how well a diagnosis predicts other flights
"""
