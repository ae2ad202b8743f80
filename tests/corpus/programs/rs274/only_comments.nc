%
(nothing)
%
