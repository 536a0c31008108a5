function y = logOf(x)
%LOGOF  Natural logarithm; NaN where x is negative, never complex.
x(x < 0) = NaN;
y = log(x);
end
