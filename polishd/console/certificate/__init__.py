"""The certificate of a part: a PDF for the customer, its twin for programs, and the seal over both."""
