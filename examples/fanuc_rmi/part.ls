/PROG  POLISH
/ATTR
COMMENT		= "polishd" ;
/MN
   1:UFRAME_NUM=1 ;
   2:UTOOL_NUM=1 ;
   3:L P[1] 20mm/sec FINE    ;
   4:L P[2] 20mm/sec FINE    ;
   5:L P[3] 20mm/sec FINE    ;
   6:  WAIT   0.50(sec) ;
   7:L P[4] 20mm/sec FINE    ;
   8:  WAIT   0.50(sec) ;
   9:L P[5] 20mm/sec FINE    ;
  10:  WAIT   0.50(sec) ;
  11:L P[6] 20mm/sec FINE    ;
  12:  WAIT   0.50(sec) ;
  13:L P[7] 20mm/sec FINE    ;
  14:  WAIT   0.50(sec) ;
  15:L P[8] 20mm/sec FINE    ;
  16:  WAIT   0.50(sec) ;
  17:L P[9] 20mm/sec FINE    ;
  18:  WAIT   0.50(sec) ;
  19:L P[10] 20mm/sec FINE    ;
  20:  WAIT   0.50(sec) ;
  21:L P[11] 20mm/sec FINE    ;
  22:  WAIT   0.50(sec) ;
  23:L P[12] 20mm/sec FINE    ;
  24:  WAIT   0.50(sec) ;
  25:L P[13] 20mm/sec FINE    ;
  26:  WAIT   0.50(sec) ;
  27:L P[14] 20mm/sec FINE    ;
  28:  WAIT   0.50(sec) ;
  29:L P[15] 20mm/sec FINE    ;
  30:  WAIT   0.50(sec) ;
  31:L P[16] 20mm/sec FINE    ;
  32:  WAIT   0.50(sec) ;
  33:L P[17] 20mm/sec FINE    ;
  34:  WAIT   0.50(sec) ;
  35:L P[18] 20mm/sec FINE    ;
  36:  WAIT   0.50(sec) ;
  37:L P[19] 20mm/sec FINE    ;
  38:  WAIT   0.50(sec) ;
  39:L P[20] 20mm/sec FINE    ;
  40:  WAIT   0.50(sec) ;
  41:L P[21] 20mm/sec FINE    ;
  42:  WAIT   0.50(sec) ;
  43:L P[22] 20mm/sec FINE    ;
  44:  WAIT   0.50(sec) ;
  45:L P[23] 20mm/sec FINE    ;
  46:  WAIT   0.50(sec) ;
  47:L P[24] 20mm/sec FINE    ;
  48:  WAIT   0.50(sec) ;
  49:L P[25] 20mm/sec FINE    ;
  50:  WAIT   0.50(sec) ;
  51:L P[26] 20mm/sec FINE    ;
  52:  WAIT   0.50(sec) ;
  53:L P[27] 20mm/sec FINE    ;
  54:  WAIT   0.50(sec) ;
  55:L P[28] 20mm/sec FINE    ;
  56:  WAIT   0.50(sec) ;
  57:L P[29] 20mm/sec FINE    ;
  58:  WAIT   0.50(sec) ;
  59:L P[30] 20mm/sec FINE    ;
  60:  WAIT   0.50(sec) ;
  61:L P[31] 20mm/sec FINE    ;
  62:  WAIT   0.50(sec) ;
  63:L P[32] 20mm/sec FINE    ;
  64:  WAIT   0.50(sec) ;
  65:L P[33] 20mm/sec FINE    ;
  66:  WAIT   0.50(sec) ;
  67:L P[34] 20mm/sec FINE    ;
  68:  WAIT   0.50(sec) ;
  69:L P[35] 20mm/sec FINE    ;
  70:  WAIT   0.50(sec) ;
  71:L P[36] 20mm/sec FINE    ;
  72:  WAIT   0.50(sec) ;
  73:L P[37] 20mm/sec FINE    ;
  74:  WAIT   0.50(sec) ;
  75:L P[38] 20mm/sec FINE    ;
  76:  WAIT   0.50(sec) ;
  77:L P[39] 20mm/sec FINE    ;
  78:  WAIT   0.50(sec) ;
  79:L P[40] 20mm/sec FINE    ;
  80:  WAIT   0.50(sec) ;
  81:L P[41] 20mm/sec FINE    ;
  82:  WAIT   0.50(sec) ;
  83:L P[42] 20mm/sec FINE    ;
  84:  WAIT   0.50(sec) ;
  85:L P[43] 20mm/sec FINE    ;
  86:  WAIT   0.50(sec) ;
  87:L P[44] 20mm/sec FINE    ;
  88:  WAIT   0.50(sec) ;
  89:L P[45] 20mm/sec FINE    ;
  90:  WAIT   0.50(sec) ;
  91:L P[46] 20mm/sec FINE    ;
  92:  WAIT   0.50(sec) ;
  93:L P[47] 20mm/sec FINE    ;
  94:  WAIT   0.50(sec) ;
  95:L P[48] 20mm/sec FINE    ;
  96:  WAIT   0.50(sec) ;
  97:L P[49] 20mm/sec FINE    ;
  98:  WAIT   0.50(sec) ;
  99:L P[50] 20mm/sec FINE    ;
 100:  WAIT   0.50(sec) ;
 101:L P[51] 20mm/sec FINE    ;
 102:  WAIT   0.50(sec) ;
 103:L P[52] 20mm/sec FINE    ;
 104:  WAIT   0.50(sec) ;
 105:L P[53] 20mm/sec FINE    ;
 106:  WAIT   0.50(sec) ;
 107:L P[54] 20mm/sec FINE    ;
 108:  WAIT   0.50(sec) ;
 109:L P[55] 20mm/sec FINE    ;
 110:  WAIT   0.50(sec) ;
 111:L P[56] 20mm/sec FINE    ;
 112:  WAIT   0.50(sec) ;
 113:L P[57] 20mm/sec FINE    ;
 114:  WAIT   0.50(sec) ;
 115:L P[58] 20mm/sec FINE    ;
 116:  WAIT   0.50(sec) ;
 117:L P[59] 20mm/sec FINE    ;
 118:  WAIT   0.50(sec) ;
 119:L P[60] 20mm/sec FINE    ;
 120:  WAIT   0.50(sec) ;
 121:L P[61] 20mm/sec FINE    ;
 122:  WAIT   0.50(sec) ;
 123:L P[62] 20mm/sec FINE    ;
 124:  WAIT   0.50(sec) ;
 125:L P[63] 20mm/sec FINE    ;
 126:  WAIT   0.50(sec) ;
 127:L P[64] 20mm/sec FINE    ;
 128:  WAIT   0.50(sec) ;
 129:L P[65] 20mm/sec FINE    ;
 130:  WAIT   0.50(sec) ;
 131:L P[66] 20mm/sec FINE    ;
 132:  WAIT   0.50(sec) ;
 133:L P[67] 20mm/sec FINE    ;
 134:  WAIT   0.50(sec) ;
 135:L P[68] 20mm/sec FINE    ;
 136:  WAIT   0.50(sec) ;
 137:L P[69] 20mm/sec FINE    ;
 138:  WAIT   0.50(sec) ;
 139:L P[70] 20mm/sec FINE    ;
 140:  WAIT   0.50(sec) ;
 141:L P[71] 20mm/sec FINE    ;
 142:  WAIT   0.50(sec) ;
 143:L P[72] 20mm/sec FINE    ;
 144:  WAIT   0.50(sec) ;
 145:L P[73] 20mm/sec FINE    ;
 146:  WAIT   0.50(sec) ;
 147:L P[74] 20mm/sec FINE    ;
 148:  WAIT   0.50(sec) ;
 149:L P[75] 20mm/sec FINE    ;
 150:  WAIT   0.50(sec) ;
 151:L P[76] 20mm/sec FINE    ;
 152:  WAIT   0.50(sec) ;
 153:L P[77] 20mm/sec FINE    ;
 154:  WAIT   0.50(sec) ;
 155:L P[78] 20mm/sec FINE    ;
 156:  WAIT   0.50(sec) ;
 157:L P[79] 20mm/sec FINE    ;
 158:  WAIT   0.50(sec) ;
 159:L P[80] 20mm/sec FINE    ;
 160:  WAIT   0.50(sec) ;
 161:L P[81] 20mm/sec FINE    ;
 162:  WAIT   0.50(sec) ;
 163:L P[82] 20mm/sec FINE    ;
 164:  WAIT   0.50(sec) ;
 165:L P[83] 20mm/sec FINE    ;
 166:  WAIT   0.50(sec) ;
 167:L P[84] 20mm/sec FINE    ;
 168:  WAIT   0.50(sec) ;
 169:L P[85] 20mm/sec FINE    ;
 170:  WAIT   0.50(sec) ;
 171:L P[86] 20mm/sec FINE    ;
 172:  WAIT   0.50(sec) ;
 173:L P[87] 20mm/sec FINE    ;
 174:  WAIT   0.50(sec) ;
 175:L P[88] 20mm/sec FINE    ;
 176:  WAIT   0.50(sec) ;
 177:L P[89] 20mm/sec FINE    ;
 178:  WAIT   0.50(sec) ;
 179:L P[90] 20mm/sec FINE    ;
 180:  WAIT   0.50(sec) ;
 181:L P[91] 20mm/sec FINE    ;
 182:  WAIT   0.50(sec) ;
 183:L P[92] 20mm/sec FINE    ;
 184:  WAIT   0.50(sec) ;
 185:L P[93] 20mm/sec FINE    ;
 186:  WAIT   0.50(sec) ;
 187:L P[94] 20mm/sec FINE    ;
 188:  WAIT   0.50(sec) ;
 189:L P[95] 20mm/sec FINE    ;
 190:  WAIT   0.50(sec) ;
 191:L P[96] 20mm/sec FINE    ;
 192:  WAIT   0.50(sec) ;
 193:L P[97] 20mm/sec FINE    ;
 194:  WAIT   0.50(sec) ;
 195:L P[98] 20mm/sec FINE    ;
 196:  WAIT   0.50(sec) ;
 197:L P[99] 20mm/sec FINE    ;
 198:  WAIT   0.50(sec) ;
 199:L P[100] 20mm/sec FINE    ;
 200:  WAIT   0.50(sec) ;
 201:L P[101] 20mm/sec FINE    ;
 202:  WAIT   0.50(sec) ;
 203:L P[102] 20mm/sec FINE    ;
 204:  WAIT   0.50(sec) ;
 205:L P[103] 20mm/sec FINE    ;
 206:  WAIT   0.50(sec) ;
 207:L P[104] 20mm/sec FINE    ;
 208:  WAIT   0.50(sec) ;
 209:L P[105] 20mm/sec FINE    ;
 210:  WAIT   0.50(sec) ;
 211:L P[106] 20mm/sec FINE    ;
 212:  WAIT   0.50(sec) ;
 213:L P[107] 20mm/sec FINE    ;
 214:  WAIT   0.50(sec) ;
 215:L P[108] 20mm/sec FINE    ;
 216:  WAIT   0.50(sec) ;
 217:L P[109] 20mm/sec FINE    ;
 218:  WAIT   0.50(sec) ;
 219:L P[110] 20mm/sec FINE    ;
 220:  WAIT   0.50(sec) ;
 221:L P[111] 20mm/sec FINE    ;
 222:  WAIT   0.50(sec) ;
 223:L P[112] 20mm/sec FINE    ;
 224:  WAIT   0.50(sec) ;
 225:L P[113] 20mm/sec FINE    ;
/POS
P[1]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.6176 mm,	Y = 8.7465 mm,	Z = 20.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.49401 deg
};
P[2]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.6176 mm,	Y = 8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.49401 deg
};
P[3]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.9201 mm,	Y = 8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.49487 deg
};
P[4]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.2225 mm,	Y = 8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.49574 deg
};
P[5]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.5250 mm,	Y = 8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.49660 deg
};
P[6]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.8274 mm,	Y = 8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.49745 deg
};
P[7]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.1299 mm,	Y = 8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.49831 deg
};
P[8]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.5677 mm,	Y = 8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.49916 deg
};
P[9]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.2652 mm,	Y = 8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.50001 deg
};
P[10]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.9628 mm,	Y = 8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.50085 deg
};
P[11]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.6603 mm,	Y = 8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.50169 deg
};
P[12]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.6603 mm,	Y = 6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.60135 deg
};
P[13]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.8072 mm,	Y = 6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.60062 deg
};
P[14]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.9540 mm,	Y = 6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.59988 deg
};
P[15]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.1009 mm,	Y = 6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.59914 deg
};
P[16]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.7522 mm,	Y = 6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.59839 deg
};
P[17]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.6053 mm,	Y = 6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.59765 deg
};
P[18]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.4585 mm,	Y = 6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.59690 deg
};
P[19]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.3116 mm,	Y = 6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.59614 deg
};
P[20]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.3116 mm,	Y = 5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69710 deg
};
P[21]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.5778 mm,	Y = 5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69763 deg
};
P[22]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.8441 mm,	Y = 5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69816 deg
};
P[23]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.1103 mm,	Y = 5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69868 deg
};
P[24]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.3766 mm,	Y = 5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69921 deg
};
P[25]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.3572 mm,	Y = 5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69973 deg
};
P[26]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.0909 mm,	Y = 5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.70025 deg
};
P[27]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.8247 mm,	Y = 5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.70076 deg
};
P[28]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.5584 mm,	Y = 5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.70128 deg
};
P[29]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.2922 mm,	Y = 5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.70179 deg
};
P[30]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.2922 mm,	Y = 3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.80119 deg
};
P[31]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.5801 mm,	Y = 3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.80086 deg
};
P[32]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.8680 mm,	Y = 3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.80052 deg
};
P[33]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.1560 mm,	Y = 3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.80018 deg
};
P[34]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.4439 mm,	Y = 3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.79983 deg
};
P[35]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.2681 mm,	Y = 3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.79949 deg
};
P[36]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.9802 mm,	Y = 3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.79915 deg
};
P[37]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.6922 mm,	Y = 3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.79880 deg
};
P[38]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.4043 mm,	Y = 3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.79846 deg
};
P[39]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.1163 mm,	Y = 3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.79811 deg
};
P[40]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.8284 mm,	Y = 3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.79776 deg
};
P[41]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.8284 mm,	Y = 1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.89888 deg
};
P[42]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.0455 mm,	Y = 1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.89906 deg
};
P[43]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.2627 mm,	Y = 1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.89924 deg
};
P[44]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.4799 mm,	Y = 1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.89942 deg
};
P[45]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.6970 mm,	Y = 1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.89960 deg
};
P[46]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.0858 mm,	Y = 1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.89978 deg
};
P[47]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.8687 mm,	Y = 1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.89996 deg
};
P[48]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.6515 mm,	Y = 1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.90014 deg
};
P[49]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.4343 mm,	Y = 1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.90031 deg
};
P[50]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.2172 mm,	Y = 1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.90049 deg
};
P[51]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.0000 mm,	Y = 1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.90067 deg
};
P[52]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.0000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[53]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.2000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[54]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.4000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[55]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.6000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[56]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.8000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[57]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.0000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[58]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.8000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[59]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.6000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[60]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.4000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[61]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.2000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[62]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.0000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[63]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.0000 mm,	Y = -1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.10114 deg
};
P[64]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.2172 mm,	Y = -1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.10096 deg
};
P[65]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.4343 mm,	Y = -1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.10078 deg
};
P[66]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.6515 mm,	Y = -1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.10059 deg
};
P[67]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.8687 mm,	Y = -1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.10042 deg
};
P[68]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.0858 mm,	Y = -1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.10024 deg
};
P[69]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.6970 mm,	Y = -1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.10006 deg
};
P[70]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.4799 mm,	Y = -1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.09988 deg
};
P[71]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.2627 mm,	Y = -1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.09970 deg
};
P[72]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.0455 mm,	Y = -1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.09953 deg
};
P[73]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.8284 mm,	Y = -1.7493 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.09935 deg
};
P[74]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.8284 mm,	Y = -3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.19870 deg
};
P[75]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.1163 mm,	Y = -3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.19904 deg
};
P[76]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.4043 mm,	Y = -3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.19938 deg
};
P[77]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.6922 mm,	Y = -3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.19972 deg
};
P[78]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.9802 mm,	Y = -3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.20006 deg
};
P[79]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.2681 mm,	Y = -3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.20040 deg
};
P[80]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.4439 mm,	Y = -3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.20074 deg
};
P[81]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.1560 mm,	Y = -3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.20109 deg
};
P[82]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.8680 mm,	Y = -3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.20144 deg
};
P[83]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.5801 mm,	Y = -3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.20178 deg
};
P[84]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.2922 mm,	Y = -3.4986 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.20213 deg
};
P[85]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.2922 mm,	Y = -5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30319 deg
};
P[86]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.5584 mm,	Y = -5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30267 deg
};
P[87]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.8247 mm,	Y = -5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30214 deg
};
P[88]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.0909 mm,	Y = -5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30161 deg
};
P[89]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.3572 mm,	Y = -5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30109 deg
};
P[90]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.3766 mm,	Y = -5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30057 deg
};
P[91]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.1103 mm,	Y = -5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30005 deg
};
P[92]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.8441 mm,	Y = -5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.29953 deg
};
P[93]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.5778 mm,	Y = -5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.29901 deg
};
P[94]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.3116 mm,	Y = -5.2479 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.29850 deg
};
P[95]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.3116 mm,	Y = -6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.39799 deg
};
P[96]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.4585 mm,	Y = -6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.39873 deg
};
P[97]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.6053 mm,	Y = -6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.39946 deg
};
P[98]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.7522 mm,	Y = -6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.40020 deg
};
P[99]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.1009 mm,	Y = -6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.40094 deg
};
P[100]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.9540 mm,	Y = -6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.40169 deg
};
P[101]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.8072 mm,	Y = -6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.40244 deg
};
P[102]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.6603 mm,	Y = -6.9972 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.40319 deg
};
P[103]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.6603 mm,	Y = -8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.50398 deg
};
P[104]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.9628 mm,	Y = -8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.50312 deg
};
P[105]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.2652 mm,	Y = -8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.50226 deg
};
P[106]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.5677 mm,	Y = -8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.50141 deg
};
P[107]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.1299 mm,	Y = -8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.50056 deg
};
P[108]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.8274 mm,	Y = -8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.49971 deg
};
P[109]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.5250 mm,	Y = -8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.49887 deg
};
P[110]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.2225 mm,	Y = -8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.49803 deg
};
P[111]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.9201 mm,	Y = -8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.49719 deg
};
P[112]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.6176 mm,	Y = -8.7465 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.49635 deg
};
P[113]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.6176 mm,	Y = -8.7465 mm,	Z = 20.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.49635 deg
};
/END
