function y = rootOf(x)
%ROOTOF  Square root; NaN where x is negative, never complex.
x(x < 0) = NaN;
y = sqrt(x);
end
